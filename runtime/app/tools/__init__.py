"""Commands for integrators: ssdnet-info, ssdnet-doctor, ssdnet-verify, ssdnet-bench."""
