"""The paper's tables, each verb of the way run in turn: one file for each dataset, one for what they share."""
