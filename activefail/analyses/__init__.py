"""From a campaign to answers: findings, probabilities, curves, designs, sensitivity, comparisons."""
