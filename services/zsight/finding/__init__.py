"""What the finder service is made of: one find, its progress, scenes that are shared, names that stay."""
