# SPDX-License-Identifier: Apache-2.0
"""The search for what a model lacks, in the order in which its files are called.

1. `candidates`: columns of every effect of the catalogue; `structure`: those of functions of the covariates.
2. `effect_search`: projects the model off them and runs the rest; the likeliest once more with what their `laws` leave
   open.
3. `posterior`: the most probable sets of candidates, with the probabilities of `estimation.priors`.
4. `evidence`: how probable the readings are with a candidate, by the likelihood of `estimation.marginal`.
5. `findings`: sizes, smallest sizes that would have been found, and look-alikes.
6. `prediction`: whether what was accepted predicts readings that were left out.
"""
