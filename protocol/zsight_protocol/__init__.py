"""What travels between the processes of zsight: messages, their bytes, their keys, their errors."""
