"""Training on several devices: Gaussians by rows, views by device."""
