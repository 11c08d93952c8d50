"""Tables, numbers, JSON, durable files, and all text that is shown or read."""
