"""The likelihood of flights: observation models, and the estimator that fits them."""
