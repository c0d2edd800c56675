"""Images of a model: MuJoCo's classic renderer, Filament, and several processes of either."""
