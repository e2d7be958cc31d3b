"""Many clips, many results: what the commands do."""
