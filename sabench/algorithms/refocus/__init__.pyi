from .edges import find_edges as find_edges
from .surface import (
    Join as Join,
    SurfaceImage as SurfaceImage,
    find_edge_on as find_edge_on,
    refocus_on_surface as refocus_on_surface,
)
from .synthetic_aperture import (
    count_views as count_views,
    refocus_by_shifts as refocus_by_shifts,
    refocus_log2 as refocus_log2,
    refocus_sum as refocus_sum,
    typical_where_covered as typical_where_covered,
)
from .thresholding import (
    ExtractionParameters as ExtractionParameters,
    extract_particles as extract_particles,
)
