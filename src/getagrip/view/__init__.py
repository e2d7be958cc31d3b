"""Pictures of results, of contact matrices and of the study; in `live`, the page of `getagrip view`."""
