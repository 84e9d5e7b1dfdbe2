"""Goals of a client of Nav2 through the real nodes, and paths followed by several drivers."""
