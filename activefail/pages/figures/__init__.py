"""Every drawing; the only package that imports matplotlib."""
