"""What changed since a reference recording: its posterior is the prior, and changes compete by their marginal likelihood."""
