"""What the method is compared with: each ``fit(problem, watch) -> Found``, as in ``joint``."""
