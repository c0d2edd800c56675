"""Laws that the library of effects does not have, and controls: recordings for the search for laws."""
