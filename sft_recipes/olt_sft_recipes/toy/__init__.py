"""The toy vision-language-action policy: Alpamayo's parts in small, trained on processor cores in minutes.

Read in this order: `inputs` (what it sees), `birds_eye`, `tokens`, `image_encoder`, `language_model`, `action_expert`,
`route_line`, `occupancy`, `paces`, `tried_paths`, `free_path`,
`plan_choice`, `policy`. What only the toy has is told in docs/toy.md.
"""
