"""Files of datasets, trackers, sensors and other programs, as clips or parts of them."""
