"""A team under its coordinator: its run, report and plot."""
