"""Pictures of results: views, tiles, still frames, contact colours and the report."""
