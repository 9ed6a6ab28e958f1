"""Random fluoroscopy: X-ray images of wires and catheters among clutter, drawn from a seed, with their masks.

`random_fluoroscopy.RandomFluoroscopy` is the way in. Arrays in, arrays out; numpy and OpenCV only.
"""
