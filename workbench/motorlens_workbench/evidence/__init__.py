"""What the recordings say of every hypothesis: sums of products by blocks of time, and what chance would put there."""
