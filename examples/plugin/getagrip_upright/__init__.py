"""What another package can add to getagrip: here, what is known of objects that stand upright."""
