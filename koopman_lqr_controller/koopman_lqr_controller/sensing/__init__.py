"""From a laser scan to what a policy sees."""
