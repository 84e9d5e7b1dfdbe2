"""Rewards of thesis Table 3.3, for learners, for the node and for recorded bags."""
