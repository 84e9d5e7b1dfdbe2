"""The pre-flight: what is wrong with a robot before it drives, by what its topics tell."""
