"""Results as pages, pictures, films and notebook cells."""
