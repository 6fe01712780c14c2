"""Bodies, servo physics, rollouts and films."""
