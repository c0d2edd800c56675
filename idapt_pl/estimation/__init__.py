"""What diagnosis, image diagnosis, appearance and trajectory matching share: fits, intervals, distances."""
