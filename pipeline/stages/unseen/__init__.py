"""The stage unseen: policies for anatomies that were not trained on."""
