"""Online: frame + database -> image (plan -> splat -> integrate -> composite)."""
