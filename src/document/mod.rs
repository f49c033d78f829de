//! Text (YAML or JSON) to typed values, every complaint with line and column.
