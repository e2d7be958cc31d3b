"""Many clips over processes: one clip's failure ends no other."""
