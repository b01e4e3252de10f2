"""The sensor file: its specification, its graph and the backends that compute it, loading, and bundles."""
