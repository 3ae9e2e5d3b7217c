"""What a find is made of: clues in a scene, hypotheses, their fit, evidence and contest."""
