from .multipass import evaluate as evaluate, evaluate_once as evaluate_once
from .parameters import (
    CorrelationParameters as CorrelationParameters,
    VolumeCorrelationParameters as VolumeCorrelationParameters,
)
from .sheet import find_sheet as find_sheet, light_in_sheet as light_in_sheet
