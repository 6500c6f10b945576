"""Commands for whoever builds the engine in: ssdnet-info, ssdnet-doctor, ssdnet-verify."""
