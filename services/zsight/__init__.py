"""Object finding in point clouds over Eclipse Zenoh: the processes, the bus, the client, the command line."""
