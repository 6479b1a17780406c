"""The view of a study, from its file alone."""

import yaml

from palpate.service.formatting import label
from palpate.service.results.read import estimates_of
from palpate.service.server.api import SearchedParameterView, StudyView
from palpate.service.server.jobs.queue import Job
from palpate.service.study.spec import StudySpec
from palpate.workers.spec import validated


def study_view(job: Job) -> StudyView:
    """Return the parameters of a queued study, and its file."""
    spec = validated(StudySpec, job.request["spec"], "The study")
    return StudyView(
        parameters=[
            SearchedParameterView(
                gene=one.gene,
                label=label(name, one.unit),
                unit=one.unit,
                lower=one.lower,
                upper=one.upper,
                target=one.target,
            )
            for name, one in estimates_of(spec, None, None).items()
        ],
        score=spec.objective.axis,
        file=yaml.safe_dump(spec.as_dict(), sort_keys=False, allow_unicode=True),
    )
