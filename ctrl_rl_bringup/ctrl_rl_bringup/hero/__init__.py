"""The README's animation: the navigator drives through a warehouse, a person crosses, the filter acts."""
