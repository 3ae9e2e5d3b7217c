"""What runs on which host: started, watched, checked."""
