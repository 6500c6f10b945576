"""Classical depth completion, without training: what a network has to beat.

```python
from runtime.completion.predictor import CompletionPredictor

prediction = CompletionPredictor("ip-basic").predict(rgb, sparse_depth)
```

A file a method; `runtime.completion.methods` names them all.
"""
