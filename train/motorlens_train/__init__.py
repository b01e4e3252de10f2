"""Data sets, the cascade network, its Bayesian-regularisation trainer, baselines, evaluation and ONNX export."""
