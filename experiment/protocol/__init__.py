"""What a study is, as its ethics board approves it: model, rules, hash, seal and page, the same in every laboratory."""
