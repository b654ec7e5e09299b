"""Descriptors on the mesh and the network behind them."""
