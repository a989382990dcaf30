"""``copcs-deploy train``: the planning network, from the expert's labels."""

from __future__ import annotations

from collections.abc import Sequence

from deploy.cli_common import DONE
from deploy.errors import InputError


def train(arguments: Sequence[str]) -> int:
    """Trains as ``python -m planner.policy.train`` does.

    Raises:
        InputError: PyTorch is not installed, which planning does not need.
        PlannerError: labels are missing, or the checkpoint is another network's.
    """
    try:
        from planner.policy.train import main  # noqa: PLC0415  (PyTorch takes seconds to load)
    except ModuleNotFoundError as error:
        if error.name != "torch":
            raise
        raise InputError("training needs PyTorch; pip install 'copcs-deploy[train]'") from error
    main(arguments, prog="copcs-deploy train")
    return DONE
