"""Files and arrays from strangers, read with limits; complete files or none written."""
