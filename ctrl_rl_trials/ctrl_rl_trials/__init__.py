"""Trials that compare: tasks that tell learning methods apart, ways to use a value function, robots and worlds."""
