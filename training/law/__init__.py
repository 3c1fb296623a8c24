"""The law of the estimator as torch modules: what tensions say of contacts on an uncertain arm."""
