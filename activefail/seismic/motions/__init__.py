"""Ground-motion records: files, sets, intensities, and the variables whose values they are."""
