"""Keys and roles: who may do what on a network."""
