// The parts of ECharts that move: everything that stands still is SVG from the server.
export * from "echarts/core";
import { use } from "echarts/core";
import { BarChart, CustomChart, LineChart, ScatterChart } from "echarts/charts";
import { DataZoomComponent, GraphicComponent, GridComponent, TooltipComponent } from "echarts/components";
import { CanvasRenderer } from "echarts/renderers";

use([LineChart, BarChart, ScatterChart, CustomChart, GridComponent, TooltipComponent, DataZoomComponent, GraphicComponent, CanvasRenderer]);
