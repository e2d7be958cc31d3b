"""The hand beside the object: its errors, its silhouette and joints, and both bodies solved together."""
