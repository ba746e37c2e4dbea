"""The toy vision-language-action policy: Alpamayo's parts in small, trained in a minute on one processor core.

Read in this order: `inputs` (what it sees), `tokens`, `image_encoder`, `language_model`, `action_expert`, `policy`.
"""
