"""The console's X-ray room: two C-arms, pedal, contrast medium, roadmap."""
