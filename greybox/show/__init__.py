"""What a person sees of a result: sentences, figures and pages. It computes nothing."""
