"""A drive through the corridor: its run, report and plot."""
