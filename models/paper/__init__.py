"""SSDNet as published: the paper's network, its ablations and its blocks."""
