"""Weights of the shipped networks, each with a card that says what it is; `Predictor.pretrained` reads them."""
