"""Koopman models: EDMD, encoders, reduction, prediction error."""
