"""The study of a robot that is not the one a policy was learnt on."""
