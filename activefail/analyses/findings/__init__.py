"""What a campaign shows so far: status, predictions, tables, notable designs, probabilities."""
