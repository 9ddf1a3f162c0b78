from .backlit_images import Profile as Profile, transmission as transmission
from .ellipse_detection import (
    find_edges as find_edges,
    find_ellipses as find_ellipses,
    radii_between as radii_between,
    vote as vote,
)
from .features import (
    PLANES as PLANES,
    STEP as STEP,
    WINDOW as WINDOW,
    FeaturePeaks as FeaturePeaks,
    attenuate as attenuate,
    compute_potential as compute_potential,
    darkness as darkness,
    drop_duplicates as drop_duplicates,
    find_blots as find_blots,
    find_depth as find_depth,
    find_outlines as find_outlines,
    merge_overlaps as merge_overlaps,
    minimum_images as minimum_images,
)
from .phases import (
    SeparatedPhases as SeparatedPhases,
    image_diameter_px as image_diameter_px,
    separate_phases as separate_phases,
)
from .search import (
    Limits as Limits,
    find_hypotheses as find_hypotheses,
    join_hypotheses as join_hypotheses,
    px_per_mm as px_per_mm,
    search_bubbles as search_bubbles,
    turn_camera as turn_camera,
    turn_grid as turn_grid,
    viewing_axes as viewing_axes,
)
