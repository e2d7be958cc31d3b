"""Pictures of results (matplotlib): reports, figures, contact matrices, the study; what pages and films draw with."""
