"""What libraries import only when they are first used: torch's optimizers, scikit-learn's embeddings."""

import sklearn.manifold  # noqa: F401
import torch._dynamo  # noqa: F401
