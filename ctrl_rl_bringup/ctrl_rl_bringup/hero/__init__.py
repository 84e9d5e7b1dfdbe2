"""The moving picture of the README: the navigator drives through a warehouse, a person crosses, the filter acts."""
