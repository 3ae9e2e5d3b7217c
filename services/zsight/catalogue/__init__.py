"""The catalogue of object types: its files, its server, its client, and teaching a new type."""
