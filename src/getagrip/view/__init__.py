"""Pictures of results, of contact matrices and of the study."""
