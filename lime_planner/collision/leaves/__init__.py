"""What leaves cost along an edge."""
