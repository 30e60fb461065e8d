"""What the readings say: data faults, changes, causes and free-form errors in one posterior.

The files in the order of the data. Faults are found and corrected first, as far as they are
certain; then everything is weighed together.

Columns of the linear model
    candidates            causes of the catalogue and their structured members
    free                  free-form errors at a joint, of a dial or of a plate
    faults                data faults as hypotheses, and their messages
    suspects              data faults as columns: slips, knocks, moved instruments, wrong commands
    twins                 parameters that neither readings nor tool tell apart
    grouping              which of these may be active, with their prior probabilities
    screening             a score test of all data faults, of which few are kept
    compressed            many readings in the few directions that could show anything
    columns               the readings, linear in all of the above

Search and posterior
    linear                the linear model and the grid of background and noise scales
    pairs                 the likeliest pairs of causes
    search                states of active groups by their evidence
    mixture               means, covariances and probabilities over the states
    everything            the posterior, linearised at its mean until that is stationary
    alternatives          what else may stand in the place of an active group

Data faults and changes
    repeats               what repeats show of the noise
    alternative_readings  signs, units, labels, shifts: other data that the readings may be
    wide                  their likelihood over wide backgrounds
    ranking               the likeliest of them, whole turns included
    credible_faults       which data faults are certain, and which may be a cause
    change_model, change, changes, recalibration
                          parameters that changed between visits or since a calibration
    data_faults           the loop that finds, corrects and reports faults and changes

Results
    causes                causes and located errors with their credible sets, as data
    base_causes           base parameters far beyond their tolerances
    outstanding           credible sets from the posterior
    members               what belongs to a class that the readings cannot tell apart
    levels                levels whose readings have a likelier meaning
    significance          whether the posterior leaves more than noise
    budget                what each cause contributes to readings and tool
    residuals             where a fit leaves most
    identifying           `identify`, `--free` and `--own`
    signatures            columns and evidence of single candidates, for planning
"""

from orthoglide.explanation.budget import BudgetItem as BudgetItem, budget as budget
from orthoglide.explanation.causes import (
    CandidateScore as CandidateScore,
    Cause as Cause,
    CredibleSets as CredibleSets,
    Curve as Curve,
    Explanation as Explanation,
    Located as Located,
)
from orthoglide.explanation.columns import with_all_parameters as with_all_parameters
from orthoglide.explanation.credible_sets import credible_sets as credible_sets
from orthoglide.explanation.free_form import visible_free_form_errors as visible_free_form_errors
from orthoglide.explanation.full_posterior import (
    FullPosterior as FullPosterior,
    full_posterior as full_posterior,
)
from orthoglide.explanation.levels import check_levels as check_levels
from orthoglide.explanation.significance import posterior_lack_of_fit as posterior_lack_of_fit
