//! The URScript language: lexer, parser, evaluator with a host interface for the built-ins.
