"""Task and peers of benchmarks/trainer.py."""
