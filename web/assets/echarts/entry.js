// The parts of ECharts for charts that change in the browser. All other charts are SVG from the server.
export * from "echarts/core";
import { use } from "echarts/core";
import { BarChart, CustomChart, LineChart, ScatterChart } from "echarts/charts";
import { DataZoomComponent, GraphicComponent, GridComponent, TooltipComponent } from "echarts/components";
import { CanvasRenderer } from "echarts/renderers";

use([LineChart, BarChart, ScatterChart, CustomChart, GridComponent, TooltipComponent, DataZoomComponent, GraphicComponent, CanvasRenderer]);
