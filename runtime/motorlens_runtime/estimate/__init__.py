"""From samples to estimates: gate and quality, filter bank, observer, features, estimator."""
