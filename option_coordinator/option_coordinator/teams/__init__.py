"""Team files, and the teams that come with the package."""
