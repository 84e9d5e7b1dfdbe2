"""Files of learnt actors, arrays and learner states."""
