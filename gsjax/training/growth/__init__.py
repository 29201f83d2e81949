"""Who gets the budget of Gaussians: the rules of density control."""
