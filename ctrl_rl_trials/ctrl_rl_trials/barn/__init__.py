"""The BARN and DynaBARN benchmark: its files as tasks, its score, and controllers that drive in it."""
