"""Commands for integrators: ssdnet-bench, -calibrate, -doctor, -info and -verify."""
