"""What is durable: the files of a run folder, written whole or not at all; the only package that imports h5py."""
