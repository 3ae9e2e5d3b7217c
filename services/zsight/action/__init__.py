"""Actions: goals that take time, their updates, and one answer each."""
