"""Compare the model with measurements, learn which physics is missing, add it and watch the error fall."""
