"""The interactive pages: a server, and the answers that it gives."""
