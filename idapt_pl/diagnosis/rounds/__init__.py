"""The steps of a search: screen, confirm, accept, look two ahead, take apart, revise, measure."""
