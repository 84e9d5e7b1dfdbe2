"""PyBullet worlds that stand in for the robots: the bridge node and Gymnasium environments."""
