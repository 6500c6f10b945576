"""The commands that train: `ssdnet-train`, `ssdnet-finetune` and `ssdnet-adapt`."""
