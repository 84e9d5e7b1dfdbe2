"""Starting, following and ending the processes of a run."""
