"""Explanation of the readings: data faults, changes, causes and free-form errors in one posterior.

The files are listed in the order of the data. Faults that are certain are found and corrected
first; then all explanations are compared together.

Limits of the search bound its time. Where one is said to change no result, the larger one gave the
same verdicts, causes and data faults, with probabilities within 0.02, for 9 or 18 simulated sweeps
of machines with one to three causes, a free-form error in half of them and a slip in a quarter.

Columns of the linear model
    candidates            causes of the catalogue, which groups of coefficients may be active, and
                          signatures of single candidates, for planning
    free_form             free-form errors at a joint or of a plate
    dial_curves           free-form errors of a dial
    faults                data faults as hypotheses, and their messages
    corrections           readings with their data faults corrected
    fault_columns         data faults as columns: slips, knocks, moved instruments, wrong commands
    twins                 parameters with equal effects on readings and tool
    screening             a score test of all data faults, after which few are kept
    compression           many readings, in the few directions that coefficients move
    columns               the readings as a linear model of all of the above

Search and posterior
    linear_model          the linear model and the grid of background and noise scales
    gains                 what groups of columns explain of a residual
    pairs                 the likeliest pairs of causes
    sparse                causes that explain the readings only together
    search                states of active groups by their evidence
    mixture               means, covariances and probabilities over the states
    base_fit              where readings are linearised, without a slip that drives it far off
    full_posterior        the posterior, linearised at its mean until that is stationary
    alternatives          alternatives to each active group

Data faults and changes
    assumed_noise         the noise assumed of each instrument: checked, enlarged, reduced
    alternative_readings  signs, units, labels, shifts, whole turns: other data that the readings
                          may be
    full_likelihood       their likelihood over wide backgrounds
    ranked_readings       the likeliest of all these; the check of levels
    credible_faults       which data faults are certain, and which may be a cause
    change, change_search, recalibration
                          parameters that changed between visits or since a calibration
    data_faults           the loop that finds, corrects and reports faults and changes

Results
    causes                causes and curves read from the posterior, and base parameters far beyond
                          their tolerances
    credible_sets         credible sets from the posterior
    lack_of_fit           tests of the lack of fit, and the residual by setup
    budget                what each cause contributes to readings and tool
    identifying           `identify`, `--free` and `--own`
"""

from orthoglide.explanation.budget import BudgetItem as BudgetItem, budget as budget
from orthoglide.explanation.causes import CredibleSets as CredibleSets
from orthoglide.explanation.columns import with_all_parameters as with_all_parameters
from orthoglide.explanation.credible_sets import credible_sets as credible_sets
from orthoglide.explanation.free_form import visible_free_form_errors as visible_free_form_errors
from orthoglide.explanation.full_posterior import (
    FullPosterior as FullPosterior,
    full_posterior as full_posterior,
)
from orthoglide.explanation.lack_of_fit import posterior_lack_of_fit as posterior_lack_of_fit
from orthoglide.explanation.ranked_readings import check_levels as check_levels
