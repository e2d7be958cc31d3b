"""Many clips, over processes: one clip's trouble ends no other."""
