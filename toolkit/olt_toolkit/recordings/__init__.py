"""What clips are built from: recordings, and the data sets that they are drives of."""
