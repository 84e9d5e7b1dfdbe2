"""The BARN and DynaBARN benchmarks: their worlds as tasks, their score, and controllers to test on them."""
