"""From a checkpoint to one verified, self-contained ONNX file of standard operators.

>>> from export.exporter import export_checkpoint
>>> report = export_checkpoint("ckpt.pt", "model.onnx", size=(512, 1024))
"""
