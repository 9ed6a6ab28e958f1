"""Reading of X-ray images: probability maps to a curve, two curves to a wire in space."""
