"""A world of simple bodies, a camera that looks at it, and the noise of real depth cameras, all seeded."""
