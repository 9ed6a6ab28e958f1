"""Jobs of the stages that train networks on images."""
