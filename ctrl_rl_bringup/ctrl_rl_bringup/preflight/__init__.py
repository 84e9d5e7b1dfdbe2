"""The pre-flight: finds what is wrong with a robot before it drives, from its topics."""
