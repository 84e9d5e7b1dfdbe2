"""Sample-efficient fine-tuning of a policy."""
