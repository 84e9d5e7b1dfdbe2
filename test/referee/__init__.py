"""A referee for the time-to-reach solvers: random systems beside solutions that owe the solvers nothing."""
