"""Transfer of a policy to a robot on which it was not trained."""
