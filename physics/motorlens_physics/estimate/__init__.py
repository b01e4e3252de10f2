"""The estimate of a motor from recordings: prepared runs, prior, noise, one minimiser."""
