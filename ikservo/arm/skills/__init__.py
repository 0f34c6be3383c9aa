"""What an arm can do besides going to a point: jog, follow, grip, lead, be taught."""
